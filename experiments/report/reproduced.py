"""What the experiments reproduce of the 2018 report, and where each stands."""

# What, what it shows, and the experiment.
REPRODUCED = (
    ("Figure 4.1", "the Kalman filter on a linear robot, five steps", "kalman"),
    ("Figure 4.2", "the extended Kalman filter on the velocity motion model", "kalman"),
    ("Figure 4.3", "the unscented Kalman filter on the same drive", "kalman"),
    ("Figures 5.3–5.5", "seven variables, their clusters, and the cluster graph", "seven_nodes"),
    ("Figure 6.1", "the Bayesian network of the localisation problem", "cluster_graph"),
    ("Figure 6.2", "its cluster graph and messages", "cluster_graph"),
    ("Table 8.1", "accuracy of four linearisations, 10,000 simulations", "linearisers"),
    ("Table 8.2", "what a linearisation costs, and the trend it promises", "linearisers"),
    ("Figure 8.1", "one of the simulations", "linearisers"),
)
