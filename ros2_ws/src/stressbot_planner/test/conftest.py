"""What all tests of the package share."""

from hypothesis import settings

# the first example of a compiled loop takes seconds, the others microseconds
settings.register_profile("stressbot", deadline=None, max_examples=60)
settings.load_profile("stressbot")
