"""Files of discrete networks: BIF, XMLBIF, UAI, libDAI's; and networks of pgmpy and pyAgrum."""

from pgm.io.networks.bif import read_bif
from pgm.io.networks.libdai import read_fg, write_fg
from pgm.io.networks.pgmpy import from_pgmpy, to_pgmpy
from pgm.io.networks.pyagrum import from_pyagrum, to_pyagrum
from pgm.io.networks.uai import read_uai, read_uai_evidence, read_uai_query
from pgm.io.networks.uai_writers import write_uai, write_uai_evidence, write_uai_result
from pgm.io.networks.writers import write_bif, write_xmlbif
from pgm.io.networks.xmlbif import read_xmlbif

__all__ = [
    "from_pgmpy",
    "from_pyagrum",
    "read_bif",
    "read_fg",
    "read_uai",
    "read_uai_evidence",
    "read_uai_query",
    "read_xmlbif",
    "to_pgmpy",
    "to_pyagrum",
    "write_bif",
    "write_fg",
    "write_uai",
    "write_uai_evidence",
    "write_uai_result",
    "write_xmlbif",
]
