"""The components of our wheel, our images and the local cluster, as CycloneDX documents.

parts.py         one component, whatever it is
requirements.py  the wheel: its requirements from the lock file
archive.py       an image's archive: Debian packages and Python packages in its layers
golang.py        compiled Go programs: the modules in them
debian.py        Debian's database of packages, and copyright files
licences.py      the text of a licence -> its SPDX identifier
cluster.py       the programs of the local cluster, and the page of their licences
document.py      components -> CycloneDX JSON
"""
