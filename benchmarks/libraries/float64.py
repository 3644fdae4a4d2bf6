"""JAX in double precision, as all the others are: imported before anything is made of it."""

import jax

jax.config.update("jax_enable_x64", True)
