"""`rigel dev`: files are copied into a node's container, whose program then starts again."""
