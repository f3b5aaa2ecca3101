"""Plans and patterns: fringe sets, unwrapping methods, the response and its correction, recordings."""
