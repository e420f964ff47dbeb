"""Property tests draw the same examples in every run: a red test is red for everybody. Random searches are commands of their own. How long an example takes
is no matter of tests (a busy machine is slow): there is no deadline."""

from hypothesis import Phase, settings

settings.register_profile("fixed", derandomize=True, deadline=None)
# For planted faults (tests/mutation): that a property broke is enough, the smallest example is not looked for.
settings.register_profile("unshrunk", derandomize=True, deadline=None, phases=(Phase.explicit, Phase.generate))
settings.load_profile("fixed")
