"""The same examples on every run: a failure that CI sees, everyone sees."""

from hypothesis import settings

settings.register_profile("turtlebag", derandomize=True, deadline=None)
settings.load_profile("turtlebag")
