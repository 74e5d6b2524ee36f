"""Images that this project builds from packages, for machines that cannot pull them."""
