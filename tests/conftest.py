"""Properties are tried on the same examples everywhere, however slow or busy the machine is."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "eiwa", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("eiwa")
