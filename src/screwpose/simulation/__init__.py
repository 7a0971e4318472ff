"""What would the detector have seen? An X-ray simulator and scenes with known truth. (floor 4)

It shares no projection with the solver, and never imports one: a bias that both had would cancel.
"""
