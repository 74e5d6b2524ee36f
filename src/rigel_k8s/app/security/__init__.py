"""`security`: what the application's containers may do."""
