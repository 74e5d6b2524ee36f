"""Pictures of the site as a browser shows it: `./run docs`, then `python -m tools.screenshots`.

views.py      which pages, in which widths and colors
browser.py    Chromium without a window, driven over a pipe
"""
