"""Results of the 2018 report that experiments reproduce, and where each stands."""

# What, what it shows, and the experiment.
REPRODUCED = (
    ("Figure 2.1", "a Gaussian of one variable, its mean μ and deviation σ", "basics"),
    ("Figure 2.2", "an error ellipse, its axes and its orientation α", "basics"),
    ("Figure 3.1", "the pose of a robot", "basics"),
    ("Figure 3.2", "two poses, and the velocities between them", "basics"),
    ("Figure 4.1", "the Kalman filter on a linear robot, five steps", "kalman"),
    ("Figure 4.2", "the extended Kalman filter on the velocity motion model", "kalman"),
    ("Figure 4.3", "the unscented Kalman filter on the same drive", "kalman"),
    ("Figures 5.1 and 5.2", "an undirected and a directed graph", "basics"),
    ("Figures 5.3–5.5", "seven variables, their clusters, and the cluster graph", "seven_nodes"),
    ("Figure 6.1", "the Bayesian network of the localisation problem", "cluster_graph"),
    ("Figure 6.2", "its cluster graph and messages", "cluster_graph"),
    ("Table 8.1", "accuracy of four linearisations, 10,000 simulations", "linearisers"),
    ("Table 8.2", "what a linearisation costs, and the trend it promises", "linearisers"),
    ("Figure 8.1", "one of the simulations", "linearisers"),
)
