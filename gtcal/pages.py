"""How all pages are made of their templates: one rule by which text from outside is shown as it is."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined

from gtcal.plain import printable


def page_environment(package: str) -> Environment:
    """Of the templates in a package's folder ``templates``. What is put into a page is escaped, its control characters
    made visible; a name that is not there is an error."""
    return Environment(
        loader=PackageLoader(package, "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shown,
    )


def _shown(value: object) -> object:
    """What is put into the page, before it is escaped."""
    return value if hasattr(value, "__html__") else printable(str(value))
