"""What is in there: CAD meshes, landmarks, parts, and a generator of parametric implants. (floor 2)"""
