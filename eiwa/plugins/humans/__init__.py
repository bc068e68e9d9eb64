"""Human models."""
