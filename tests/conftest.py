"""Property tests draw the same examples in every run: a red test is red for everybody. Random searches are commands of their own."""

from hypothesis import Phase, settings

settings.register_profile("fixed", derandomize=True)
# For planted faults (tests/mutation): that a property broke is enough, the smallest example is not looked for.
settings.register_profile("unshrunk", derandomize=True, phases=(Phase.explicit, Phase.generate))
settings.load_profile("fixed")
