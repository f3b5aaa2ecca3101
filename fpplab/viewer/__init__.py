"""The viewer: what every command shows of its work, in a window or a page on this computer."""
