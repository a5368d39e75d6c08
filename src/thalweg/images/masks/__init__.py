"""Masks of water, sky and the own boat, learnt from each campaign."""
