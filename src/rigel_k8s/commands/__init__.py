"""What a command does, as functions: they join the features, and print nothing."""
