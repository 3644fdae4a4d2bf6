"""How the tests run: property tests draw the same examples everywhere, and are not timed."""

from hypothesis import settings

settings.register_profile("everywhere", deadline=None, derandomize=True, max_examples=50)
# pytest --hypothesis-profile=thorough draws many, and others each time.
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.load_profile("everywhere")
