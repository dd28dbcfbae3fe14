# SPDX-License-Identifier: Apache-2.0
"""JSON schema of the result document."""

import json

from pydantic.json_schema import GenerateJsonSchema

from multilica.results.document.result import ResultDocument

__all__ = ["schema_text"]


class UntitledSchema(GenerateJsonSchema):
    """A schema without titles of fields, which only repeat their names."""

    def field_title_should_be_set(self, schema: object) -> bool:  # noqa: ARG002
        """Leave out every title."""
        return False


def schema_text() -> str:
    """Return the text of `docs/result.schema.json`."""
    schema = ResultDocument.model_json_schema(schema_generator=UntitledSchema)
    return json.dumps({"$schema": UntitledSchema.schema_dialect, **schema}, indent=1, ensure_ascii=False)
