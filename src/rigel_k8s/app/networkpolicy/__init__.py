"""`network_policy`: which pods and addresses may connect to the application's pods."""
