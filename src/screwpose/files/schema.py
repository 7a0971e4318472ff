"""The formats of case, truth, result and summary files, as pydantic models."""

from pydantic import BaseModel


class ResultFile(BaseModel):
    """result.json."""
