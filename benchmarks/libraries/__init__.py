"""The libraries, one file for each and kind of work; pgm is one of them."""
