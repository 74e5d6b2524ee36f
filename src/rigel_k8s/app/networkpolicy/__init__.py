"""`network_policy`: who may connect to the application's pods."""
