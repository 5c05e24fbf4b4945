"""Addresses of archives: what is none, and what holds a password, is one sentence."""

import pytest

from daemon.archive.address import ArchiveError, is_archive, parse_archive


def test_a_database_and_an_installation_behind_it():
    found = parse_archive("postgresql://me@db.plant:5433/plant?sslmode=require#site/roof")
    assert (found.url, found.installation) == ("postgresql://me@db.plant:5433/plant?sslmode=require", "site/roof")
    assert str(found) == "postgresql://me@db.plant:5433/plant?sslmode=require#site/roof"
    assert str(parse_archive("postgres:///plant")) == "postgres:///plant"
    assert not is_archive("/var/lib/heliocube")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("postgresql://db.plant", "is no address of an archive"),
        ("postgresql://db.plant/a/b", "is no address of an archive"),
        ("mysql://db.plant/a", "is no address of an archive"),
        ("postgresql://db.plant:port/a", "an archive is postgresql://USER@HOST/DATABASE"),
        ("postgresql://me:secret@db.plant/a", "postgresql://me:...@db.plant/a holds a password"),
        ("postgresql://db.plant/a?password=secret", "the address holds a password"),
    ],
)
def test_no_archive(text, part):
    with pytest.raises(ArchiveError) as error:
        parse_archive(text)
    assert part in str(error.value)
    assert "secret" not in str(error.value)
