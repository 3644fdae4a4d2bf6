"""Discrete networks: messages as tables.

The files, in the order of the computation. What is laid out is laid out once for a graph, when it
is asked for the second time; numbers come with the evidence.

Where tables stand:

- ``place``: one table in the flat array that holds the tables of all clusters;
- ``storage``: that array, and the clusters' potentials in it;
- ``sums``: sums of entries of the array, as of a table to a sepset or to one variable, or over axes
  of a large table, where it stands; messages multiplied into it;
- ``evidence``: states and weights put into it; batches of runs cut into pieces that fit, runs of
  equal evidence computed once.

Graphs without loops:

- ``first_question``: the answer to a first question, of one run, cluster by cluster, and the
  beliefs that it makes;
- ``tree_plan``: lays out the passes, clusters of one shape as the columns of one matrix;
- ``tree_passes``: messages to the roots and back, with numbers or with logarithms, and the tables
  with which they begin, so that messages to the roots are sent from evidence alone; single
  messages by their definition, made on request;
- ``enumeration``: of tiny networks the joint of all variables, of which every table is a sum;
- ``tree_beliefs``: the calibrated tables of all runs;
- ``maximum``: maxima in place of sums, and the most probable assignment.

Graphs of any shape, on which messages go round:

- ``loopy_messages``: rounds of messages, laid out with clusters of one shape in one call, and the
  beliefs and the Bethe value that they make.

Measurement:

- ``impossible``: evidence of probability zero, and where it contradicts the tables;
- ``posterior``: the result of `pgm.infer`, and joints of variables of one cluster, or of several
  of a tree;
- ``run``: evidence, a schedule and a graph to a posterior.
"""

from pgm.inference.discrete.run import run

__all__ = ["run"]
