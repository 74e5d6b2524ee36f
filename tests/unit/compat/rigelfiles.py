"""Rigelfiles that both Rigel 0.3 and this package read."""

DOCKERFILE = """\
vars:
  base: ros:noetic

application:
  distro: noetic

jobs:
  dockerfile:
    plugin: rigel_k8s.DockerfilePlugin
    with:
      ros_image: "{{ vars.base | regex_replace(':.*', ':1.10') }}"
      command: roslaunch a b.launch
  other:
    plugin: rigel_k8s.DockerfilePlugin
    with:
      ros_image: other
      command: other
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: Not_A_Name
      application_image: a

sequences:
  build:
    stages:
      - jobs:
          - name: dockerfile
            with: {command: rosrun c d}
"""
