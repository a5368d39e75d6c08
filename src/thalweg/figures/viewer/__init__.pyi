from .page import (
    MOST_POINTS as MOST_POINTS,
    Node as Node,
    View as View,
    build_octree as build_octree,
    read_view as read_view,
    write_viewer as write_viewer,
)
