"""Examples are drawn by hypothesis, the same ones every time."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "certnav",
    deadline=None,
    derandomize=True,
    max_examples=50,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.load_profile("certnav")
