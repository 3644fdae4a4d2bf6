"""Files of discrete networks: BIF, XMLBIF, UAI; and networks of pgmpy."""

from pgm.io.networks.bif import read_bif
from pgm.io.networks.pgmpy import from_pgmpy, to_pgmpy
from pgm.io.networks.uai import read_uai, read_uai_evidence
from pgm.io.networks.writers import write_bif, write_xmlbif
from pgm.io.networks.xmlbif import read_xmlbif

__all__ = [
    "from_pgmpy",
    "read_bif",
    "read_uai",
    "read_uai_evidence",
    "read_xmlbif",
    "to_pgmpy",
    "write_bif",
    "write_xmlbif",
]
