"""The Rigelfiles that `rigel init` writes: a talker and a listener, ready to be changed."""

from __future__ import annotations

from collections.abc import Mapping
from string import Template

TEXT = Template("""\
# What can be done here:
#   rigel check                every problem of this file, with line and column
#   rigel run sequence demo    build the image, push it, deploy it, wait until all is ready
#   rigel status               $status
#   rigel logs listener -f     the output of a node

# Values for {{ vars.NAME }}. Names that are not here are looked up in the environment.
vars:
  # Where images are pushed to; must be reachable from every machine of the cluster. Write your own:
  # `rigel cluster status` prints that of a local cluster.
  registry: registry.example/me
  image: "{{ vars.registry }}/my-robot"
  version: "1.0"

application:
  distro: $distro
  dir: .                 # the sources, relative to this file

# What can be done. Each job is a plugin and its options.
jobs:
  # Writes a Dockerfile for the $workspace workspace in application.dir; leave it out to keep yours.
  dockerfile:
    plugin: rigel_k8s.DockerfilePlugin
    with:
      command: [$run, $package, talker]
      apt: [$apt]

  # Builds it with docker or podman, and pushes it to where the cluster pulls from.
  build:
    plugin: rigel_k8s.BuildXPlugin
    with:
      image: "{{ vars.image }}"
      tags: ["{{ vars.version }}"]
      push: true
      platforms: [linux/amd64]     # add linux/arm64 for machines with ARM

$deploys  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: my-robot
      # An unprivileged user and read-only images. Device files are refused with it; if you remove
      # it, every node loses it.
      security: restricted
$network      image: "{{ vars.image }}:{{ vars.version }}"
      nodes:
        talker:
          package: $package
          executable: talker
          # parameters: {rate: $rate}
          # remappings: {chatter: /robot/chatter}
        listener:
          package: $package
          executable: listener
          # On a different machine from the talker:
          # placement: {apart_from: [talker]}
          # resources: {requests: {cpu: 100m, memory: 64Mi}}

# Which jobs run in which order: `rigel run sequence NAME`.
sequences:
  demo:
    stages:
      - jobs: [dockerfile, build, deploy]

  # A new version: only what changed is rolled out.
  update:
    stages:
      - jobs: [build, deploy]
""")


def render_starter(words: Mapping[str, str]) -> str:
    """Return the Rigelfile with the words of a generation of ROS."""
    return TEXT.substitute(words)
