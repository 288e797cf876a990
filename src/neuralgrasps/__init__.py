"""Grasping with any robot hand."""

__version__ = "0.1.0"
