"""The matrices that machine code is written with: their protocol, and the two kinds of them."""
