"""Test machines differ in speed: no example of a property has a deadline."""

from hypothesis import settings

settings.register_profile("eiwa", deadline=None)
settings.load_profile("eiwa")
