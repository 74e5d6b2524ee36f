FROM ros:noetic
USER root

# Interactive shells (kubectl exec -it POD -- bash) know ROS as well.
RUN { id -u rigeluser >/dev/null 2>&1 || useradd --create-home --user-group --shell /bin/bash rigeluser; } \
    && mkdir -p /home/rigeluser/ros_workspace/src \
    && chown -R rigeluser: /home/rigeluser/ros_workspace \
    && chmod a+rx /home/rigeluser \
    && printf '%s\n' \
        'source /opt/ros/noetic/setup.bash' \
        'source /home/rigeluser/ros_workspace/devel/setup.bash' \
        >> /etc/bash.bashrc

# What builds the workspace; Debian and packages.ros.org name it differently.
RUN . /etc/os-release \
    && case "$ID" in \
        debian) tools="catkin python3-rosdep2" ;; \
        *) tools="ros-noetic-catkin python3-rosdep" ;; \
    esac \
    && apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        build-essential \
        cmake \
        $tools \
    && rm -rf /var/lib/apt/lists/* \
    && rm -f /etc/catkin/profile.d/1.ros_distro.sh

# Only the package.xml files, so that this layer outlives an edit of the sources.
COPY --chown=rigeluser:rigeluser src/hello/package.xml /home/rigeluser/ros_workspace/src/demo/src/hello/package.xml
RUN { [ -e /etc/ros/rosdep/sources.list.d/20-default.list ] || rosdep init; } \
    && rosdep update --rosdistro noetic --include-eol-distros \
    && echo 'APT::Install-Recommends false;' > /etc/apt/apt.conf.d/90rosdep \
    && apt-get update \
    && DEBIAN_FRONTEND=noninteractive rosdep install --rosdistro noetic \
        --from-paths /home/rigeluser/ros_workspace/src --ignore-src -r -y \
    && rm -rf /var/lib/apt/lists/* /root/.ros/rosdep /etc/apt/apt.conf.d/90rosdep

COPY --chown=rigeluser:rigeluser . /home/rigeluser/ros_workspace/src/demo/

USER rigeluser

WORKDIR /home/rigeluser/ros_workspace

RUN bash -c 'source /opt/ros/noetic/setup.bash && catkin_make --cmake-args -DCMAKE_BUILD_TYPE=Release '"'"'-DFLAGS=-O2 -g'"'"''

COPY dockerfile_entrypoint.sh /home/rigeluser/robot-entrypoint.sh

ENTRYPOINT ["/bin/bash", "/home/rigeluser/robot-entrypoint.sh"]
CMD ["bash"]
