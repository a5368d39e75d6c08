"""The calibration field by a self-calibrating bundle of photographs."""
