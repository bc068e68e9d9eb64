"""Stored rows and re-evaluated designs as figures."""
