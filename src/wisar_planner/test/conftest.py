"""Settings of all tests of the library."""

from hypothesis import settings

# The first call of a kernel may compile it, and machines may be busy: no deadline. The same
# examples every time, so that a failure can be repeated.
settings.register_profile("wisar", deadline=None, derandomize=True)
settings.load_profile("wisar")
