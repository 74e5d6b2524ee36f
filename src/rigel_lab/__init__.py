"""A real Kubernetes on this machine, and images, from package registries alone.

Users have `rigel cluster` and `rigel image`; everything else serves the demo and the tests of this
project (`python -m rigel_lab`). README.md beside this file has more.

cluster/   a cluster of Linux namespaces: lifecycle.py starts and ends it, components.py has its
           programs, node.py and control_plane.py their command lines
images/    base images and the project's own programs as images: base/ turns a recipe into an
           archive and delivers it, each other folder is a recipe

It must not know Rigelfiles, jobs, releases or networks of applications; rigel_k8s reaches it
through `rigel_k8s.lab` alone.
"""
