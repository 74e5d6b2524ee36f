"""What the images that the project builds have in common; independent of each of them.

bootstrap.py  mmdebstrap: packages to a root file system
layer.py      what the images of both ROS have: their entrypoint and configuration
build.py      the way from a recipe to the archive, with its cache
engine.py     the archive into podman or docker, and into a registry
"""
