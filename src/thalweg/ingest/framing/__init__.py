"""Frames of ANPP and SBP in a byte stream, with resynchronisation after damage."""
