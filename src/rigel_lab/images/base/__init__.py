"""What the images that the project builds have in common; knows none of them.

bootstrap.py  mmdebstrap: packages to a root file system
layer.py      a few files and links to a layer
archive.py    layers to an archive that podman, docker and containerd load
build.py      the way from a recipe to the archive, with its cache
engine.py     the archive into podman or docker, and into a registry
"""
