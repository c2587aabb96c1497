"""What holds for all tests."""

from hypothesis import HealthCheck, settings

# A busy machine is no defect: neither a property nor the drawing of its examples is timed.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")
