from .ground import all_pairs as all_pairs
