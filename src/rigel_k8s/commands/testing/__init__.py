"""test: a job or a sequence in a namespace of its own, its tests, and what they leave."""
