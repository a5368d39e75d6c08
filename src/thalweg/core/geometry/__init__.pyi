from .cells import (
    LEAST_AREA_M2 as LEAST_AREA_M2,
    CellGrid as CellGrid,
    cell_numbers as cell_numbers,
    crossing_in_words as crossing_in_words,
    first_crossing as first_crossing,
    polygon_area_m2 as polygon_area_m2,
)
from .mesh import (
    ORDERS as ORDERS,
    PlyElement as PlyElement,
    TriangleMesh as TriangleMesh,
    frame_of_comments as frame_of_comments,
    read_mesh as read_mesh,
    read_ply_header as read_ply_header,
    write_mesh as write_mesh,
)
from .octree import (
    CELLS_BITS as CELLS_BITS,
    LEAF_POINTS as LEAF_POINTS,
    Node as Node,
    Part as Part,
    build_octree as build_octree,
    codes_of as codes_of,
    cube_size_m as cube_size_m,
    grow as grow,
    node_key as node_key,
    parts_of as parts_of,
)
from .point_fit import fit_points as fit_points, nearest_rotation as nearest_rotation
from .raycast import MAX_EXTENT_M as MAX_EXTENT_M, Hits as Hits, RayCaster as RayCaster, _open3d as _open3d
