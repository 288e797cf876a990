"""The `neuralgrasps` command: one file per verb."""
