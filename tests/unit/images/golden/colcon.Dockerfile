FROM ros:humble
USER root

# Interactive shells (kubectl exec -it POD -- bash) know ROS as well.
RUN { id -u rigeluser >/dev/null 2>&1 || useradd --create-home --user-group --shell /bin/bash rigeluser; } \
    && mkdir -p /home/rigeluser/ros_workspace/src \
    && chown -R rigeluser: /home/rigeluser/ros_workspace \
    && chmod a+rx /home/rigeluser \
    && printf '%s\n' \
        'source /opt/ros/humble/setup.bash' \
        'source /home/rigeluser/ros_workspace/install/setup.bash' \
        >> /etc/bash.bashrc

# What builds the workspace; Debian and packages.ros.org name it differently.
RUN . /etc/os-release \
    && case "$ID" in \
        debian) tools="colcon python3-colcon-bash python3-colcon-cmake python3-colcon-defaults python3-colcon-library-path python3-colcon-metadata python3-colcon-output python3-colcon-package-selection python3-colcon-parallel-executor python3-colcon-recursive-crawl python3-colcon-ros python3-setuptools python3-rosdep2" ;; \
        *) tools="python3-colcon-common-extensions python3-rosdep" ;; \
    esac \
    && apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        build-essential \
        cmake \
        $tools \
    && rm -rf /var/lib/apt/lists/*

# Only the package.xml files, so that this layer outlives an edit of the sources.
COPY --chown=rigeluser:rigeluser src/hello/package.xml /home/rigeluser/ros_workspace/src/demo/src/hello/package.xml
RUN { [ -e /etc/ros/rosdep/sources.list.d/20-default.list ] || rosdep init; } \
    && rosdep update --rosdistro humble --include-eol-distros \
    && echo 'APT::Install-Recommends false;' > /etc/apt/apt.conf.d/90rosdep \
    && apt-get update \
    && DEBIAN_FRONTEND=noninteractive rosdep install --rosdistro humble \
        --from-paths /home/rigeluser/ros_workspace/src --ignore-src -r -y \
    && rm -rf /var/lib/apt/lists/* /root/.ros/rosdep /etc/apt/apt.conf.d/90rosdep

COPY --chown=rigeluser:rigeluser . /home/rigeluser/ros_workspace/src/demo/

USER rigeluser

WORKDIR /home/rigeluser/ros_workspace

RUN bash -c 'source /opt/ros/humble/setup.bash && colcon build'

COPY dockerfile_entrypoint.sh /home/rigeluser/robot-entrypoint.sh

ENTRYPOINT ["/bin/bash", "/home/rigeluser/robot-entrypoint.sh"]
CMD ["ros2", "run", "a", "b c"]
