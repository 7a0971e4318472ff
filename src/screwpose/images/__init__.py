"""What did the detector see? (floor 1)"""
