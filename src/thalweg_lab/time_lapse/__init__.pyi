from .foreground import OwnBoat as OwnBoat
from .record import (
    draw_images as draw_images,
    metered_exposure as metered_exposure,
    simulate_time_lapse as simulate_time_lapse,
    sun_of as sun_of,
)
from .renderer import Renderer as Renderer, World as World
