"""What a command does, as functions: they join the rooms, print nothing and know no click."""
