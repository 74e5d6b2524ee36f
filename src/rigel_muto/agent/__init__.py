"""What Muto's agent receives and answers; the page is rigel_muto/__init__.py."""
