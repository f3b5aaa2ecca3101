"""What the lengths of a shape must keep to."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from fpplab.core.errors import ConfigError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def check_positive(shape: DataclassInstance) -> None:
    """Raise `ConfigError` unless every field of the shape holds lengths above 0 mm."""
    for field in fields(shape):
        values = np.atleast_1d(getattr(shape, field.name))
        if values.size == 0 or not (np.isfinite(values).all() and (values > 0).all()):
            raise ConfigError(
                f"{type(shape).__name__}.{field.name}: {values.tolist()} must be lengths above 0 mm"
            )


def check_below(shape: DataclassInstance, field: str, value: float, limit: float, of: str) -> None:
    """Raise `ConfigError` unless the value of a shape's field is less than the limit, which is that `of`."""
    if not value < limit:
        raise ConfigError(
            f"{type(shape).__name__}.{field}: {value:g} mm must be less than {limit:g} mm, {of}"
        )
