"""The typed configuration, and what is built from it."""
