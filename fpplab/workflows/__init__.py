"""What a command does, as a function: a request in, a result out."""
