"""Two discrete networks that every textbook has: the wet grass, and the chest clinic."""

import pgm

ANSWERS = ("no", "yes")

# The wet grass. `sprinkler` is the network.
cloudy = pgm.Discrete("cloudy", ANSWERS)
sprinkling = pgm.Discrete("sprinkler", ANSWERS)
rain = pgm.Discrete("rain", ANSWERS)
wet = pgm.Discrete("wet", ANSWERS)

# The chest clinic: a patient's history, illnesses, and what the doctor finds.
visit = pgm.Discrete("visit", ANSWERS)  # to Asia, lately
smoking = pgm.Discrete("smoking", ANSWERS)
tuberculosis = pgm.Discrete("tuberculosis", ANSWERS)
cancer = pgm.Discrete("cancer", ANSWERS)  # of the lung
bronchitis = pgm.Discrete("bronchitis", ANSWERS)
either = pgm.Discrete("either", ANSWERS)  # tuberculosis or cancer, which an X-ray cannot tell apart
xray = pgm.Discrete("xray", ANSWERS)  # positive
dyspnoea = pgm.Discrete("dyspnoea", ANSWERS)


def sprinkler() -> pgm.BayesianNetwork:
    """Why the grass is wet: clouds bring rain and keep the sprinkler off.

        p(cloudy) p(sprinkler | cloudy) p(rain | cloudy) p(wet | sprinkler, rain)

    Notes
    -----
    The network of Russell and Norvig, Artificial Intelligence (1995), with their numbers.
    P(rain = yes | wet = yes) = 0.7079.
    """
    return pgm.BayesianNetwork(
        [
            pgm.TableCPD(cloudy, table=_yes(0.5)),
            pgm.TableCPD(sprinkling, given=cloudy, table=[_yes(0.5), _yes(0.1)]),
            pgm.TableCPD(rain, given=cloudy, table=[_yes(0.2), _yes(0.8)]),
            pgm.TableCPD(
                wet,
                given=(sprinkling, rain),
                table=[[_yes(0.0), _yes(0.9)], [_yes(0.9), _yes(0.99)]],
            ),
        ]
    )


def asia() -> pgm.BayesianNetwork:
    """The causes of a patient's short breath; `either` is a deterministic table.

        p(visit) p(smoking) p(tuberculosis | visit) p(cancer | smoking) p(bronchitis | smoking)
        p(either | tuberculosis, cancer) p(xray | either) p(dyspnoea | either, bronchitis)

    Notes
    -----
    The network of Lauritzen and Spiegelhalter, Local computations with probabilities on graphical
    structures and their application to expert systems (1988), with their numbers. The loop of
    smoking, cancer, either and bronchitis has no chord: a junction tree fills one in.
    """
    certainly, never = _yes(1.0), _yes(0.0)
    return pgm.BayesianNetwork(
        [
            pgm.TableCPD(visit, table=_yes(0.01)),
            pgm.TableCPD(smoking, table=_yes(0.5)),
            pgm.TableCPD(tuberculosis, given=visit, table=[_yes(0.01), _yes(0.05)]),
            pgm.TableCPD(cancer, given=smoking, table=[_yes(0.01), _yes(0.1)]),
            pgm.TableCPD(bronchitis, given=smoking, table=[_yes(0.3), _yes(0.6)]),
            pgm.TableCPD(
                either,
                given=(tuberculosis, cancer),
                table=[[never, certainly], [certainly, certainly]],
            ),
            pgm.TableCPD(xray, given=either, table=[_yes(0.05), _yes(0.98)]),
            pgm.TableCPD(
                dyspnoea,
                given=(either, bronchitis),
                table=[[_yes(0.1), _yes(0.8)], [_yes(0.7), _yes(0.9)]],
            ),
        ]
    )


def _yes(probability: float) -> tuple[float, float]:
    """The probabilities of no and yes."""
    return 1.0 - probability, probability
