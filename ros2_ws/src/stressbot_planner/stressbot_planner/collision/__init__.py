"""The only validity checker, and shortest paths among what must not be touched."""
