"""The JSON Schemas of the files, made from their models.

``python -m screwpose.files.publish_schemas [FOLDER]`` writes them, by default to where the package ships them; a test
holds that those are what the models say.
"""

import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from screwpose.files.atomic import json_text, write_text
from screwpose.files.schema import CaseFile, ResultFile, SummaryFile, TruthFile

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SHIPPED = Path(__file__).parent / "schemas"
_MODELS: dict[str, type[BaseModel]] = {
    "case": CaseFile,
    "truth": TruthFile,
    "result": ResultFile,
    "summary": SummaryFile,
}


def schema_documents() -> dict[str, dict[str, Any]]:
    """The JSON Schema of each kind of file: ``case``, ``truth``, ``result``, ``summary``.

    A schema states the shape: keys, types, bounds. What needs arithmetic (a pose is rigid, a matrix is not singular, a
    label stands once in a view) is checked on load.
    """
    documents = {}
    for name, model in _MODELS.items():
        body = _without_titles(model.model_json_schema())
        documents[name] = {"$schema": DIALECT, "$id": f"urn:screwpose:schema:{name}:1", "title": f"{name}.json", **body}
    return documents


def publish(folder: Path = SHIPPED) -> list[Path]:
    """Write the schemas as ``<name>.schema.json``; returns their paths.

    Raises
    ------
    OutputError
        They cannot be written.
    """
    return [
        write_text(folder / f"{name}.schema.json", json_text(document) + "\n")
        for name, document in schema_documents().items()
    ]


def _without_titles(node: Any, is_names: bool = False) -> Any:
    """Drop pydantic's titles, which repeat the keys; `is_names`: the node's keys are names of properties, not words."""
    if isinstance(node, dict):
        return {
            key: _without_titles(value, key in ("properties", "$defs") and not is_names)
            for key, value in node.items()
            if key != "title" or is_names
        }
    return [_without_titles(item) for item in node] if isinstance(node, list) else node


if __name__ == "__main__":
    for written in publish(*(Path(argument) for argument in sys.argv[1:2])):
        sys.stdout.write(f"{written}\n")
