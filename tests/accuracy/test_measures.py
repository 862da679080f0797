"""The table of hand measurements: what it may hold, and how its mistakes are named."""

import pytest

from cherrypicker.accuracy.measures import read_measures
from cherrypicker.accuracy.quantities import QUANTITIES, known_unit
from cherrypicker.errors import StageError

HEAD = "tree,trait,value,unit,who,height_m,azimuth_deg,x_m,y_m,z_m,order\n"


@pytest.fixture
def read(tmp_path):
    path = tmp_path / "measures.csv"

    def read(text, head=HEAD):
        path.write_text(head + text, encoding="utf-8")
        return read_measures(path)

    return read


@pytest.mark.parametrize(
    "row, value",
    [
        ("a,trunk_diameter_m,64,mm", 0.064),
        ("a,trunk_diameter,6.4,cm", 0.064),
        ("a,trunk_diameter,2.5,in", 0.0635),
        ("a,tcsa,0.0032,m²", 32.0),
        ("a,wood_volume,5.6,l", 0.0056),
        ("a,n_tips,61,", 61.0),
        ("a,branch_angle,50,°,AB,1.2,90", 50.0),
    ],
)
def test_values_are_read_in_the_unit_of_their_trait(read, row, value):
    assert read(row)[0].value == pytest.approx(value)


def test_spreadsheets_with_semicolons_write_decimal_commas(read):
    (row,) = read("a;height;2,31;m;Ann\n\n# a remark\n", "\ufefftree;trait;value;unit;who\n")
    assert (row.value, row.who, row.given) == (2.31, "Ann", "2.31 m")


@pytest.mark.parametrize(
    "row, column, told",
    [
        (
            "a,trunk_diameter,64,mmm",
            "unit",
            "'mmm' is no unit of trunk_diameter_m; it may be in m,",
        ),
        ("a,trunk_diameter,64,deg", "unit", "no unit of trunk_diameter_m"),
        ("a,trunk_diameter,48,m", "unit", "48 m makes no sense as trunk diameter; was it measured"),
        ("a,trunk_diameter,48,m", "unit", "in cm or mm"),
        ("a,height,2.3,mm", "unit", "was it measured in m"),
        ("a,branch_angle,1200,deg,,1,2", "value", "1200 deg makes no sense"),
        ("a,trunk_diametre,64,mm", "trait", "did you mean 'trunk_diameter_m'?"),
        ("a,height,2m30,m", "value", "'2m30', which is no number"),
        ("a,branch_diameter,20,mm", "height_m", "needs its place"),
        ("a,branch_diameter,20,mm,,,,0.1,0.2", "x_m", "a point needs x_m, y_m and z_m"),
        ("a,branch_diameter,20,mm,,1,90,,,,1.5", "order", "an order is 0 for the trunk"),
        (",height,2.3,m", "tree", "no tree is named"),
    ],
)
def test_a_wrong_row_is_named_with_its_line(read, row, column, told):
    with pytest.raises(StageError, match="line 3") as caught:
        read(f"a,height,2.3,m\n{row}")
    assert told in caught.value.cause
    assert caught.value.key == column


def test_a_wrong_head_names_the_nearest_column(read):
    with pytest.raises(StageError, match="did you mean 'azimuth_deg'"):
        read("", "tree,trait,value,unit,azimut\n")
    with pytest.raises(StageError, match="the column 'unit' is missing"):
        read("", "tree,trait,value\n")


def test_only_the_default_table_may_be_missing(tmp_path):
    assert read_measures(tmp_path / "none.csv", may_miss=True) == []
    with pytest.raises(StageError, match="cannot be read") as caught:
        read_measures(tmp_path / "none.csv")
    assert caught.value.key == "measures"


def test_every_quantity_has_a_unit_and_values_that_make_sense():
    for quantity in QUANTITIES.values():
        assert known_unit(quantity.unit) in quantity.units
        assert quantity.units[quantity.unit] == 1.0
        assert quantity.low < quantity.high
