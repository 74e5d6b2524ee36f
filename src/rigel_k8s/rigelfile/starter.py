"""The Rigelfile that `rigel init` writes: a talker and a listener, ready to be changed."""

from __future__ import annotations

__all__ = ["STARTER"]

STARTER = """\
# What can be done here:
#   rigel check                every problem of this file, with line and column
#   rigel run sequence demo    build the image, push it, deploy it, wait until all is ready
#   rigel status               what runs where, and what is wrong with it
#   rigel logs listener -f     what a node says

# Values for {{ vars.NAME }}. What is not here is looked up in the environment.
vars:
  registry: localhost:5000         # where images are pushed to, and the cluster pulls from
  image: "{{ vars.registry }}/my-robot"
  version: "1.0"

application:
  distro: noetic
  dir: .                 # the sources, relative to this file

# What can be done. Each job is a plugin and its options.
jobs:
  # Writes a Dockerfile for the catkin workspace in application.dir. Leave it out to keep your own.
  dockerfile:
    plugin: rigel_k8s.DockerfilePlugin
    with:
      command: [rosrun, rospy_tutorials, talker]
      apt: [ros-noetic-rospy-tutorials]

  # Builds it with docker or podman, and pushes it to where the cluster pulls from.
  build:
    plugin: rigel_k8s.BuildXPlugin
    with:
      image: "{{ vars.image }}"
      tags: ["{{ vars.version }}"]
      push: true
      platforms: [linux/amd64]

  # Deploys a ROS master and the nodes, each in a pod of its own, and waits until they are ready.
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: my-robot
      deploy_ros_master: true
      image: "{{ vars.image }}:{{ vars.version }}"
      nodes:
        talker:
          package: rospy_tutorials
          executable: talker
          # parameters: {rate: 10}
          # remappings: {chatter: /robot/chatter}
        listener:
          package: rospy_tutorials
          executable: listener
          # On another machine than the talker:
          # placement: {apart_from: [talker]}
          # resources: {requests: {cpu: 100m, memory: 64Mi}}

# Which jobs run in which order: `rigel run sequence NAME`.
sequences:
  demo:
    stages:
      - jobs: [dockerfile, build, deploy]

  # A new version of the same: only what changed is rolled out.
  update:
    stages:
      - jobs: [build, deploy]
"""
