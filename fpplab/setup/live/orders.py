"""What the operator can order during the set-up, by key or on the page; both go through one queue."""

from enum import StrEnum
from queue import SimpleQueue

from fpplab.setup.live.patterns import View


class Order(StrEnum):
    """An order of the operator."""

    LONGER = "longer"
    SHORTER = "shorter"
    MORE_GAIN = "more_gain"
    LESS_GAIN = "less_gain"
    ADVICE = "advice"
    MEASURE = "measure"
    WHITE = "white"
    BLACK = "black"
    COARSE = "coarse"
    FINE = "fine"
    CHECKER = "checker"
    CROSS = "cross"
    FORWARD = "forward"
    BACK = "back"
    HOME = "home"
    TAKE = "take"
    NEXT_POSE = "next_pose"
    RESET = "reset"
    QUIT = "quit"


WORDS = {
    Order.LONGER: ("+", "exposure +"),
    Order.SHORTER: ("-", "exposure −"),
    Order.MORE_GAIN: (">", "gain +"),
    Order.LESS_GAIN: ("<", "gain −"),
    Order.ADVICE: ("a", "take the advised exposure"),
    Order.MEASURE: ("m", "measure (fringes)"),
    Order.WHITE: ("w", "white"),
    Order.BLACK: ("b", "black"),
    Order.COARSE: ("c", "coarse fringes"),
    Order.FINE: ("f", "fine fringes"),
    Order.CHECKER: ("k", "checkerboard"),
    Order.CROSS: ("x", "cross"),
    Order.FORWARD: ("]", "stage +"),
    Order.BACK: ("[", "stage −"),
    Order.HOME: ("h", "home the stage"),
    Order.TAKE: ("t", "take a pose of the board"),
    Order.NEXT_POSE: ("n", "next pose of the fixture"),
    Order.RESET: ("r", "forget the best focus"),
    Order.QUIT: ("q", "quit"),
}

BY_KEY = {key: order for order, (key, _) in WORDS.items()}  # the order of each key

VIEW_ORDERS = {Order(view.value): view for view in View}  # the orders that choose what the projector shows

Orders = SimpleQueue[Order]  # orders that wait, the first first
