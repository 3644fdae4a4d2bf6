"""Worlds of finitely many states in which a robot loses and finds itself."""

from models.worlds.building import Building, building
from models.worlds.grid_world import grid_world
from models.worlds.hallway import hallway
from models.worlds.maze import MAZE, maze, walls
from models.worlds.world import COMPASS, World

__all__ = [
    "COMPASS",
    "MAZE",
    "Building",
    "World",
    "building",
    "grid_world",
    "hallway",
    "maze",
    "walls",
]
