"""Cones in lidar clouds and photographs: model, search, fit."""
