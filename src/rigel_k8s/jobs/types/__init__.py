"""The job types and providers, one module each; they do not print."""
