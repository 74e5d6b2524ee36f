"""Images of applications: the job types dockerfile and buildx.

It stands above `rigel_k8s`, which never imports this package; an entry point (pyproject.toml) leads
to each job type.

recipe.py      a Dockerfile as text
dockerfile.py  the job that writes it, with what it needs beside it
buildx.py      the job that builds and pushes an image, for several machines at once; its engine
               (engine.py) is docker.py or podman.py
process.py     their programs, whose output progress.py shows
"""
