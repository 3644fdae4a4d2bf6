"""The best answer that the library can vouch for, and its verdict."""
