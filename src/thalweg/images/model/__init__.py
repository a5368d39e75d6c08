"""What the steps hand on: blocks of image points, poses, control points, cameras."""
