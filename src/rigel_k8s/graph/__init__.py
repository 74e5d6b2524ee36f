"""Which nodes of a release discover which, looked at from inside their pods."""
