"""Reading, checking, completing and documenting campaign files."""
