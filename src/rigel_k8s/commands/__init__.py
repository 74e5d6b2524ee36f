"""What a command does, as functions: they join the features, print nothing and know no click."""
