# SPDX-License-Identifier: Apache-2.0
"""Base class and value types of the configuration sections."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["Count", "Metres", "Positive", "PositiveMetres", "Section", "Share"]

Positive = Annotated[float, Field(gt=0.0)]
PositiveMetres = Annotated[float, Field(gt=0.0)]
Metres = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1)]


class Section(BaseModel):
    """A table of the configuration: frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)
