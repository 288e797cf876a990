"""Style sheet and script of the report page, which go into the page itself."""

from __future__ import annotations

from importlib.resources import files

from neuralgrasps.report.palette import contact_gradient


def page_css() -> str:
    """The style sheet, with the contact colour scale that the pictures use."""
    return f":root {{ --contact-scale: {contact_gradient()}; }}\n" + _asset("page.css")


def page_script() -> str:
    """The script: enlarge a picture, mark the section in view. Without "<" and "&", so that the page is also XML."""
    return _asset("page.js")


def _asset(name: str) -> str:
    return (files("neuralgrasps") / "assets" / "report" / name).read_text(encoding="utf-8")
