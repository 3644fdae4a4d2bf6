"""The finding of each experiment: its question, and a sentence with numbers from its summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from string import Formatter
from typing import Any


@dataclass(frozen=True)
class Finding:
    """A question and its answer.

    Attributes
    ----------
    question : str
    sentence : str
        A template. ``{rmse/Taylor/filter:.2f}`` is the number at that path of summary.json, where
        ``*`` is the first of all keys, and
        ``{rmse/smoother against rmse/filter:+.0%}`` how far the first number is from the second,
        as a part of the second.
    figure : str
        The experiment's figure, without ending, that shows it at the top of the report; empty
        where the finding stands in the experiment's own section alone.
    """

    question: str
    sentence: str
    figure: str = ""


# Those with a figure are the report's headlines, in this order.
FINDINGS = {
    "smoothing": Finding(
        "How much better is a smoother than a filter?",
        "Over {settings/runs} simulated drives of {settings/steps} steps the position of the "
        "unscented smoother is off by {rmse/Unscented/smoother:.3f} m (RMSE), that of the filter "
        "by {rmse/Unscented/filter:.3f} m "
        "({rmse/Unscented/smoother against rmse/Unscented/filter:+.0%}); their mean NEES, 3 where "
        "a belief knows its error, are {nees/Unscented/smoother:.2f} and "
        "{nees/Unscented/filter:.2f}.",
        "rmse",
    ),
    "plaza": Finding(
        "And on a recorded robot?",
        "On the mower's recording plaza1 dead reckoning is off by {plaza1/dead_reckoning:.2f} m "
        "(RMSE of the position), the filter with Taylor by {plaza1/Taylor/filter:.3f} m and the "
        "smoother by {plaza1/Taylor/smoother:.3f} m "
        "({plaza1/Taylor/smoother against plaza1/Taylor/filter:+.0%}).",
        "plaza1_path",
    ),
    "linearisers": Finding(
        "Which lineariser for a strongly curved motion?",
        "Where the heading is uncertain by about 1 rad (setting R1) the mean KL from the true "
        "belief is {table_8_1/R1/Taylor:.3f} nats with Taylor, "
        "{table_8_1/R1/Unscented:.3f} with the unscented rule and {table_8_1/R1/MC100:.4f} with "
        "100 Monte Carlo samples; where it is known to 0.1 rad these are "
        "{contrast/mean/Taylor:.2g}, {contrast/mean/Unscented:.2g} and {contrast/mean/MC100:.2g}.",
        "figure_8_1",
    ),
    "nonlinear_measurement": Finding(
        "Which lineariser for a nonlinear measurement?",
        "Near a landmark, the heading uncertain by 0.6 rad, the mean KL from the exact posterior "
        "is {kl/near/0.6/Taylor:.2f} nats with Taylor and {kl/near/0.6/Cubature:.2f} with "
        "cubature. A filter that iterates its sensors has {kl/near/0.6/IteratedCubature:.3f}, a "
        "smoother that iterates the motion too {kl/near/0.6/IteratedSmoother:.4f}, pgm.estimate "
        "{estimates/near/kl:.4f}. Two collinear beacons leave two places: there cubature has "
        "{kl/collinear/0.6/Cubature:.2f}, that smoother "
        "{kl/collinear/0.6/IteratedSmoother:.2f}, and pgm.estimate "
        "{estimates/collinear/kl:.3f}.",
        "kl_against_cost",
    ),
    "particle_counts": Finding(
        "Are particles better than a Kalman filter?",
        "On the linear problem, where the Kalman filter is exact, its RMSE is "
        "{estimators/1/Kalman filter/rmse/value:.4f} m and that of 100 particles "
        "{estimators/1/100 particles/rmse/value:.4f} m; on problem 2b, a turning robot with one "
        "landmark, the unscented filter has {estimators/2b/unscented Kalman/rmse/value:.3f} m and "
        "1,000 particles have {estimators/2b/1,000 particles/rmse/value:.3f} m.",
        "errors",
    ),
    "global_localisation": Finding(
        "Can a robot be found that may be anywhere?",
        "Of {success/grid/runs} drives through a house that begin anywhere, "
        "{success/grid/count} end right with a grid, {success/particles, field/count} with "
        "{settings/particles} particles and a likelihood field, and "
        "{success/particles, beams/count} of {success/particles, beams/runs} with beams.",
        "map",
    ),
    "belief_propagation": Finding(
        "How far are loopy beliefs from exact ones?",
        "In random discrete networks on a {settings/side} × {settings/side} grid a marginal on the "
        "Bethe graph is off by "
        "{methods/discrete/*/Bethe/error_mean:.4f} in the mean; on a robot's loop with "
        "unknown landmarks means agree within "
        "{localisation/bethe/residual/mean_error:.0e} exact deviations, and deviations are "
        "{localisation/bethe/residual/std_ratio_min:.3f} to "
        "{localisation/bethe/residual/std_ratio_max:.3f} of the exact ones.",
        "methods",
    ),
    "localisation": Finding(
        "What do a filter and a smoother make of the same drive?",
        "Over {settings/runs} drives the unscented smoother's position is off by "
        "{rmse/Unscented/smoother:.3f} m (RMSE), the filter's by {rmse/Unscented/filter:.3f} m "
        "({rmse/Unscented/smoother against rmse/Unscented/filter:+.0%}).",
    ),
    "comparison_at_scale": Finding(
        "How near may a landmark be for an EKF?",
        "Over {settings/runs} drives about a landmark at 4 m, seen with a bearing of 0.02 rad, the "
        "EKF's mean NEES, 3 where a belief knows its error, is "
        "{nees/EKF/4 m/0.02 rad:.2f} and the unscented filter's {nees/UKF/4 m/0.02 rad:.2f}; at "
        "0.5 m these are {nees/EKF/0.5 m/0.02 rad:.3g} and {nees/UKF/0.5 m/0.02 rad:.3g}, and "
        "{lost/EKF/0.5 m/0.02 rad:.0%} and {lost/UKF/0.5 m/0.02 rad:.0%} of the drives are lost.",
    ),
    "iterated": Finding(
        "Does iterating help?",
        "Linearising twice takes the RMSE of the unscented smoother on the cubic growth model from "
        "{growth/cubic/Unscented/smoother/plain/1/rmse:.2f} to "
        "{growth/cubic/Unscented/smoother/plain/2/rmse:.2f}, and that of the cubature smoother "
        "around one landmark from {chains/Cubature/smoother/plain/1/rmse:.3f} m to "
        "{chains/Cubature/smoother/plain/2/rmse:.3f} m.",
    ),
    "kalman": Finding(
        "Does the cluster graph give the textbook's filters?",
        "Kalman, extended and unscented filters and smoothers differ from textbook "
        "implementations by {largest_difference:.0e} at most.",
    ),
    "slam": Finding(
        "How far does it reach that a loop is closed?",
        "When the robot sees the beginning of its way of {closing/way:.0f} m again, the deviation "
        "of the median pose of the last quarter goes to {closing/ratio:.2f} of what it was, and "
        "poses {closing/reach:.0f} m back are known at least a tenth better; over {settings/runs} "
        "runs landmarks are off by {landmarks/rmse:.3f} m (RMSE), dead reckoning by "
        "{dead_reckoning:.2f} m, and the NEES is {landmarks/nees:.2f} a degree of freedom where 1 "
        "is right.",
    ),
    "pose_graphs": Finding(
        "What do loop closures do that are false?",
        "With {settings/false} false closures for each right one the poses of the drawn graph are "
        "off by {results/*/against_truth/least squares/rmse:.2f} m (RMSE) by least squares, by "
        "{results/*/against_truth/truncated least squares/rmse:.2f} m with truncated least "
        "squares, and by {results/*/against_truth/right closures/rmse:.2f} m without false ones, "
        "where their NEES is {results/*/against_truth/right closures/nees:.2f} a degree of "
        "freedom.",
    ),
    "recordings": Finding(
        "What do gates and robust noise gain on a real recording?",
        "On {settings/data/0} the filter is off by {results/*/filter/Taylor/rmse:.3f} m, gated by "
        "{results/*/gated filter/Taylor/rmse:.3f} m; the smoother by "
        "{results/*/smoother/Taylor/rmse:.3f} m, with robust noise by "
        "{results/*/robust smoother/Taylor/rmse:.3f} m.",
    ),
    "wide_start": Finding(
        "Which lineariser bears a start that is hardly known?",
        "Begun within {settings/data/0}'s wide prior, nine in ten starts have a mean NEES below "
        "{results/*/Taylor/nees_90:.3g} with Taylor and below {results/*/unscented/nees_90:.2g} "
        "with unscented points; 1 is right.",
    ),
    "calibration": Finding(
        "Does a recording tell how its own sensor is off?",
        "Learnt from {settings/data/0} without the truth, the scale of its ranges comes to "
        "{results/*/parameter/end/scale:.4f} (fitted with the truth {results/*/fitted/scale:.4f}), "
        "their offset to {results/*/parameter/end/offset:.3f} m ({results/*/fitted/offset:.3f} m), "
        "their noise to {results/*/parameter/end/range:.3f} m (about the truth "
        "{results/*/fitted/residual:.3f} m); the smoother's error goes from "
        "{results/*/parameter/start/smoother:.2f} m to {results/*/parameter/end/smoother:.3f} m.",
    ),
    "learning": Finding(
        "Can noise be learnt from the readings alone?",
        "From five times the true variances, over {settings/runs} recordings of {settings/steps} "
        "steps, the median process noise of the turning target comes to "
        "{median/turn/Taylor/process:.2f} of the truth with Taylor and to "
        "{median/turn/cubature/process:.2f} with cubature, the noise of its bearings to "
        "{median/turn/cubature/bearing:.2f}.",
    ),
    "imu_heading": Finding(
        "What does one reading of the heading tell?",
        "It takes the heading's variance from {ours/predicted_variance:.4f} to "
        "{ours/variance:.5f} rad², with a gain of {ours/gain:.3f} where the reference, by a slip, "
        "prints {printed/gain:.3f}.",
    ),
    "differential_drive": Finding(
        "Do filters of a differential drive know their errors?",
        "Over {settings/runs} drives of the linear problem the filter's mean NEES is "
        "{results/deviation/1/exact/filter/nees:.2f} where 2 is right; of the problem with one "
        "landmark and the larger noise, where 3 is right, it is "
        "{results/variance/2b/Taylor/filter/nees:.2f} with Taylor and "
        "{results/variance/2b/Unscented/filter/nees:.2f} with the unscented rule.",
    ),
    "freiburg": Finding(
        "Where do linearisers part on a recording?",
        "The mean KL of the filtered belief from a particle filter's is "
        "{divergence/alone/Taylor/mean:.2f} nats with Taylor and "
        "{divergence/alone/unscented/mean:.2f} with the unscented rule.",
    ),
    "killian": Finding(
        "How well does a laser find a robot in a map?",
        "Particles are {particles/rmse:.3f} m (RMS) from the recording's poses, odometry alone "
        "{dead_reckoning/rmse:.2f} m.",
    ),
    "grid_localisation": Finding(
        "What becomes of a filter that starts wrong?",
        "Over a drive of {settings/steps} steps a Taylor filter that starts at a wrong place has a "
        "mean NEES of {starts/wrong/Taylor/filter/nees:.0f} where 3 is right, one that starts "
        "right {starts/right/Taylor/filter/nees:.2f}, and the grid, which is told nothing of the "
        "start, {grid/by_kind/filtered/nees:.2f}.",
    ),
    "kidnapped": Finding(
        "Is a robot found again that was carried elsewhere?",
        "Of {success/none/runs} drives {success/none/count} end right without particles put "
        "elsewhere, {success/uniform/count} with particles put anywhere, and "
        "{success/likelihood/count} with particles put where the scan may be of.",
    ),
    "basics": Finding(
        "Do the figures of the basics show what they say?",
        "Of draws from the Gaussian of Figure 2.2 a share of {inside/within_ellipse:.4f} lies in "
        "its 95 % ellipse, and {inside/within_std:.4f} of those of Figure 2.1 within one standard "
        "deviation of the mean.",
    ),
    "cluster_graph": Finding(
        "Are messages the Bayes filter's beliefs?",
        "On {clusters} clusters and {sepsets} sepsets the messages differ from the extended Kalman "
        "filter and smoother by {largest_difference:.0e} at most.",
    ),
    "seven_nodes": Finding(
        "Are the messages of Figure 5.5 right?",
        "Marginals, beliefs, sepsets and evidence differ from those of the dense joint by "
        "{largest_difference:.0e} at most.",
    ),
    "grid_world": Finding(
        "Does the filter give the lecture's numbers?",
        "Beliefs differ from the textbook's Bayes filter and smoother by "
        "{largest_difference:.0e} at most.",
    ),
    "hallway": Finding(
        "How sure is a robot of its cell in a corridor?",
        "The right cell has a mean probability of {at_truth/filter:.2f} in the filter and "
        "{at_truth/smoother:.2f} in the smoother.",
    ),
    "maze": Finding(
        "Does one wrong reading mislead a robot in a maze?",
        "Of {possible/0} cells {possible/4} are left after four steps, one of them misread; "
        "beliefs differ from the textbook's filter and smoother by {largest_difference:.0e} at "
        "most.",
    ),
    "topological": Finding(
        "Do doors and junctions tell a robot where it is?",
        "Its right place has a mean probability of {at_truth/filter/place:.2f} in the filter and "
        "{at_truth/smoother/place:.2f} in the smoother, its right heading "
        "{at_truth/filter/heading:.2f} and {at_truth/smoother/heading:.2f}.",
    ),
    "manoeuvre": Finding(
        "What does it gain to know the ways in which a target moves?",
        "Over {settings/runs} targets that turn now and then the place is off by "
        "{methods/one motion/smoother:.2f} m (RMSE, smoothed) with one motion of larger noise, by "
        "{methods/IMM/smoother:.2f} m with the interacting multiple model, and by "
        "{methods/3 Gaussians/smoother:.2f} and {methods/9 Gaussians/smoother:.2f} m with three "
        "and nine Gaussians, whose mode is the right one in {methods/3 Gaussians/right:.0%} and "
        "{methods/9 Gaussians/right:.0%} of the steps.",
    ),
    "height_and_group": Finding(
        "What does a weight tell of a group and of a height?",
        "Someone of {weights/1:.0f} kg is of the first group with the probability {chance/1:.2f}, "
        "and {height/1:.1f} ± {std/1:.1f} cm tall, a mixture of two Gaussians.",
    ),
    "incinerator": Finding(
        "Are the figures of Lauritzen's paper found?",
        "The emission of heavy metals, given industrial waste, light and dioxide, has the mean "
        "{after/metals_out/mean/1:.3f} and the deviation {after/metals_out/std/1:.3f}; published "
        "are {after/metals_out/mean/0:.2f} and {after/metals_out/std/0:.3f}.",
    ),
    "outlier_cause": Finding(
        "Is a fault that lasts better a state than robust noise?",
        "The smoothed place is off by {methods/one noise/smoother:.2f} m (RMSE) where fixes have "
        "one noise, by {methods/Student's t/smoother:.2f} m with Student's t, and by "
        "{methods/fault as a state/smoother:.2f} m with the fault as a state, which is told right "
        "at {found:.1%} of the steps; the gate loses targets, "
        "{methods/gate of 99 %/smoother:.1f} m.",
    ),
    "two_targets": Finding(
        "What is lost by taking the likeliest source of a reading?",
        "Where two targets cross, a filter that takes the likeliest has a NEES of "
        "{methods/the likeliest, 1/nees:.2f} a component, and loses or swaps them in "
        "{methods/the likeliest, 1/lost:.0%} of the runs; summed over all that a reading may be "
        "these are {methods/summed, 1/nees:.2f} and {methods/summed, 1/lost:.0%}, with one "
        "Gaussian.",
    ),
    "unknown_landmarks": Finding(
        "And where a recorded robot does not know what it sees?",
        "With disturbed odometry and hidden identities the smoothed path is off by "
        "{ways/the likeliest/error:.3f} m (RMSE) if each sighting is given its likeliest landmark, "
        "by {ways/joint compatibility/error:.3f} m by joint compatibility, and by "
        "{ways/summed, 1/error:.3f} m summed over all landmarks, with one Gaussian; with the "
        "identities known it is {ways/named/error:.3f} m.",
    ),
    "mirror": Finding(
        "Are both places found where ranges leave two open?",
        "From {settings/starts} starts both were found in {found_both:.0%} of "
        "{settings/drives} drives; the mean KL divergence of a grid from their mixture is "
        "{mean_divergence:.3f} nats, and {mean_adapted:.3f} after it was adapted by draws.",
    ),
}


def answer(name: str, summary: Mapping[str, Any]) -> str:
    """The sentence of an experiment's finding as HTML, each number bound to its place.

    Parameters
    ----------
    name : str
        The experiment's; an empty answer where nothing is said of it.
    summary : mapping
        Its summary.json.

    Raises
    ------
    KeyError
        If the summary lacks a number that the sentence names.
    """
    if name not in FINDINGS:
        return ""
    shown = []
    for text, path, form, _ in Formatter().parse(FINDINGS[name].sentence):
        shown.append(escape(text))
        if path is not None:
            number = format(value(path, summary), form or "").replace("-", "\N{MINUS SIGN}")
            shown.append(f'<data value="{escape(path)}">{escape(number)}</data>')
    return "".join(shown)


def value(path: str, summary: Mapping[str, Any]) -> Any:
    """The number at a path of a summary, or how far one is from another, as a part of that."""
    if " against " in path:
        one, other = (value(part, summary) for part in path.split(" against "))
        return one / other - 1.0
    found: Any = summary
    for key in path.split("/"):
        if key == "*":
            key = next(iter(found))
        found = found[int(key)] if isinstance(found, list) else found[key]
    return found
