"""Commands of Muto carried out on one release."""
