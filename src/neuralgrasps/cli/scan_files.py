"""Readers that moved to `neuralgrasps.perception.frame_files`."""

from neuralgrasps.perception.frame_files import read_cloud, read_depth, read_mask

__all__ = ["read_cloud", "read_depth", "read_mask"]
