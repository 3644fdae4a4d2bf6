"""How the site is made: pages' programs are run, and what they draw is shown below them."""
