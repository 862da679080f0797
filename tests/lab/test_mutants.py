from pathlib import Path

import mutate
import yaml


def test_the_line_of_each_mutant_stands_in_its_file_and_its_tests_are_there(project):
    for each in yaml.safe_load(mutate.LIST.read_text(encoding="utf-8")):
        mutate._texts(Path(project), each)  # an error, where it stands there never or twice
        for test in each["tests"]:
            assert Path(project, test.split("::")[0]).exists(), each
