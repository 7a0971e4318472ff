"""What the documentation shows of the rest of the repository: the JSON Schemas and the changelog, as they are."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

_ROOT = Path(__file__).resolve().parents[1]
_SCHEMAS = _ROOT / "src" / "screwpose" / "files" / "schemas"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add ``schemas/*.schema.json`` and ``changelog.md`` to the site."""
    for schema in sorted(_SCHEMAS.glob("*.schema.json")):
        files.append(File.generated(config, f"schemas/{schema.name}", abs_src_path=str(schema)))
    files.append(File.generated(config, "changelog.md", abs_src_path=str(_ROOT / "CHANGELOG.md")))
    return files
