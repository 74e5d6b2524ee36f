FROM ros:noetic
USER root

COPY requirements.txt /tmp/requirements-0.txt
COPY ["a b.txt", "/tmp/requirements-1.txt"]
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        python3-pip \
    && rm -rf /var/lib/apt/lists/* \
    && PIP_BREAK_SYSTEM_PACKAGES=1 python3 -m pip install --no-cache-dir \
        -r /tmp/requirements-0.txt \
        -r /tmp/requirements-1.txt \
    && rm /tmp/requirements-*.txt

# Interactive shells (kubectl exec -it POD -- bash) know ROS as well.
RUN { id -u rigeluser >/dev/null 2>&1 || useradd --create-home --user-group --shell /bin/bash rigeluser; } \
    && mkdir -p /home/rigeluser/ros_workspace/src \
    && chown -R rigeluser: /home/rigeluser/ros_workspace \
    && chmod a+rx /home/rigeluser \
    && printf '%s\n' \
        'source /opt/ros/noetic/setup.bash' \
        'export ROS_PACKAGE_PATH="/home/rigeluser/ros_workspace/src:$ROS_PACKAGE_PATH"' \
        >> /etc/bash.bashrc

COPY --chown=rigeluser:rigeluser . /home/rigeluser/ros_workspace/src/demo/

USER rigeluser

WORKDIR /home/rigeluser/ros_workspace/src/demo

COPY dockerfile_entrypoint.sh /home/rigeluser/robot-entrypoint.sh

ENTRYPOINT ["/bin/bash", "/home/rigeluser/robot-entrypoint.sh"]
CMD ["bash"]
