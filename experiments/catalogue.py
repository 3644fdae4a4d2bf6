"""The experiments by name; each module or package has `run`, and `QUICK`, its quick settings."""

from types import ModuleType

from experiments import belief_propagation, localisation, plaza, seven_nodes

# In the order in which a newcomer would run them.
EXPERIMENTS: dict[str, ModuleType] = {
    "localisation": localisation,
    "plaza": plaza,
    "seven_nodes": seven_nodes,
    "belief_propagation": belief_propagation,
}
