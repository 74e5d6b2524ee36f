"""Which nodes of a release discover which, examined from inside their pods."""
