"""How well does a posed scene explain the images? (floor 3)"""

from screwpose.similarity.engine import EngineScores, SceneEngine
from screwpose.similarity.reference import dice, forward_differences, gradient_correlation_loss
from screwpose.similarity.scene import Posed, SceneScore, Silhouette, ViewScore, score_rows, score_scene, union_mask
from screwpose.similarity.target import Target, Window, make_target

__all__ = [
    "EngineScores",
    "Posed",
    "SceneEngine",
    "SceneScore",
    "Silhouette",
    "Target",
    "ViewScore",
    "Window",
    "dice",
    "forward_differences",
    "gradient_correlation_loss",
    "make_target",
    "score_rows",
    "score_scene",
    "union_mask",
]
