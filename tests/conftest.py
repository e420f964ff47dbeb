"""Property tests draw the same examples in every run: a red test is red for everybody. Random searches are commands of their own."""

from hypothesis import settings

settings.register_profile("fixed", derandomize=True)
settings.load_profile("fixed")
