FROM ros:humble
USER root

# Interactive shells (kubectl exec -it POD -- bash) know ROS as well.
RUN { id -u rigeluser >/dev/null 2>&1 || useradd --create-home --user-group --shell /bin/bash rigeluser; } \
    && mkdir -p /home/rigeluser/ros_workspace/src \
    && chown -R rigeluser: /home/rigeluser/ros_workspace \
    && chmod a+rx /home/rigeluser \
    && printf '%s\n' \
        'source /opt/ros/humble/setup.bash' \
        >> /etc/bash.bashrc

COPY --chown=rigeluser:rigeluser . /home/rigeluser/ros_workspace/src/demo/

USER rigeluser

WORKDIR /home/rigeluser/ros_workspace/src/demo

COPY dockerfile_entrypoint.sh /home/rigeluser/robot-entrypoint.sh

ENTRYPOINT ["/bin/bash", "/home/rigeluser/robot-entrypoint.sh"]
CMD ["bash"]
