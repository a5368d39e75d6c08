from .model import VLP16 as VLP16
from .reader import VelodyneReader as VelodyneReader
