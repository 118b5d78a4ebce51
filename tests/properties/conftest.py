"""Properties are tested on the same examples everywhere, and leave nothing behind."""

from hypothesis import HealthCheck, Phase, settings

settings.register_profile(
    "sure",
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=14,
    phases=(Phase.explicit, Phase.generate, Phase.shrink),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("sure")
