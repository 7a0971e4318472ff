"""JSON Schema as far as ours use it, by its specification (draft 2020-12): an oracle without pydantic."""

from typing import Any

_TYPES = {"object": dict, "array": list, "string": str, "number": (int, float), "integer": int, "null": type(None)}
_KNOWN = {
    *("$schema", "$id", "$defs", "$ref", "title", "description", "default", "type", "properties", "required"),
    *("additionalProperties", "propertyNames", "minProperties", "items", "prefixItems", "minItems", "maxItems"),
    *("minLength", "minimum", "maximum", "enum", "const", "anyOf"),
}


def faults(value: Any, schema: dict[str, Any], root: dict[str, Any] | None = None, place: str = "") -> list[str]:
    """Where `value` breaks `schema`; empty where it does not."""
    root = schema if root is None else root
    assert set(schema) <= _KNOWN, f"unknown words: {set(schema) - _KNOWN}"
    if "$ref" in schema:
        schema = {**root["$defs"][schema["$ref"].removeprefix("#/$defs/")], **schema}
    if "anyOf" in schema and all(faults(value, option, root, place) for option in schema["anyOf"]):
        return [f"{place}: none of anyOf"]
    found = []
    if "type" in schema and (not isinstance(value, _TYPES[schema["type"]]) or isinstance(value, bool)):
        return [f"{place}: not of type {schema['type']}"]
    if "enum" in schema and value not in schema["enum"]:
        found.append(f"{place}: not in enum")
    if "const" in schema and value != schema["const"]:
        found.append(f"{place}: not the constant")
    if isinstance(value, str) and len(value) < schema.get("minLength", 0):
        found.append(f"{place}: too short")
    if isinstance(value, int | float) and not schema.get("minimum", value) <= value <= schema.get("maximum", value):
        found.append(f"{place}: out of range")
    if isinstance(value, list):
        found += _list_faults(value, schema, root, place)
    if isinstance(value, dict):
        found += _object_faults(value, schema, root, place)
    return found


def _list_faults(value: list[Any], schema: dict[str, Any], root: dict[str, Any], place: str) -> list[str]:
    if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
        return [f"{place}: {len(value)} items"]
    first = schema.get("prefixItems", [])
    found = []
    for index, item in enumerate(value):
        found += faults(
            item, first[index] if index < len(first) else schema.get("items", {}), root, f"{place}[{index}]"
        )
    return found


def _object_faults(value: dict[str, Any], schema: dict[str, Any], root: dict[str, Any], place: str) -> list[str]:
    found = [f"{place}.{key}: required" for key in schema.get("required", []) if key not in value]
    if len(value) < schema.get("minProperties", 0):
        found.append(f"{place}: too few properties")
    for key, item in value.items():
        if key in schema.get("properties", {}):
            found += faults(item, schema["properties"][key], root, f"{place}.{key}")
        elif schema.get("additionalProperties") is False:
            found.append(f"{place}.{key}: additional")
        else:
            found += faults(item, schema.get("additionalProperties", {}), root, f"{place}.{key}")
            found += faults(key, schema.get("propertyNames", {}), root, f"{place}.{key} (name)")
    return found
