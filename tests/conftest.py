"""Fixtures shared by all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

ASSETS = Path(__file__).resolve().parents[1].parent / "shared" / "assets"


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder of real meshes, URDFs and scans; tests that need it are skipped without it."""
    if not ASSETS.is_dir():
        pytest.skip(f"real data not found at {ASSETS}")
    return ASSETS
