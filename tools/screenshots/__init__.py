"""Pictures of the site as a browser shows it: `./run docs`, then `python -m tools.screenshots`.

views.py      which pages, in which widths and colors
release.py    the pictures of docs/ui.md, of a real release
"""
