# SPDX-License-Identifier: Apache-2.0
"""Base class and value types of the configuration sections."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict

from multilica.documents import require_length

NotNegative = Annotated[float, Strict(), Field(ge=0.0)]
Positive = Annotated[float, Strict(), Field(gt=0.0)]
PositiveMetres = Annotated[float, Strict(), Field(gt=0.0), AfterValidator(require_length)]
Metres = Annotated[float, Strict(), Field(ge=0.0), AfterValidator(require_length)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
Count = Annotated[int, Strict(), Field(ge=1)]


class Section(BaseModel):
    """A table of the configuration: frozen, without unknown keys or numbers that are not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
