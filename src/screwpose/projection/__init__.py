"""Which pixels does a posed mesh cover? (floor 1)

`reference.silhouette` defines it; `opencv.silhouette` is the paper's; `silhouette.silhouette` is the quick one. All
take projected vertices, so that nothing here knows of cameras or images.
"""

__all__: list[str] = []
