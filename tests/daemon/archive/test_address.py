"""Addresses of archives: what is none, and what holds a password, is one sentence."""

import pytest

from daemon.archive.address import ArchiveAddress, ArchiveError, is_archive, load_password, parse_archive


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
        ("postgresql://me:secret@db.plant:port/a", "an archive is postgresql://USER@HOST/DATABASE"),
        ("postgresql://me:secret@db..plant/a", "a part of the host's name is empty or longer than 63 letters"),
        ("postgresql://me:secret@db.plant/a", "postgresql://me:...@db.plant/a holds a password"),
        ("postgresql://db.plant/a?password=secret", "the address holds a password"),
    ],
)
def test_no_archive(text, part):
    with pytest.raises(ArchiveError) as error:
        parse_archive(text)
    assert part in str(error.value)
    assert "secret" not in str(error.value)


def test_a_password_is_one_line_that_no_other_user_reads(tmp_path):
    file = tmp_path / "archive.password"
    with pytest.raises(ArchiveError, match="write the database's password into it, mode 0600"):
        load_password(file)
    file.write_text("se cret\n")
    file.chmod(0o644)
    with pytest.raises(ArchiveError, match="is open to others than its owner"):
        load_password(file)
    file.chmod(0o600)
    assert load_password(file) == "se cret"
    file.write_text("one\ntwo\n")
    with pytest.raises(ArchiveError, match="is not one line with a password"):
        load_password(file)
    assert "secret" not in repr(ArchiveAddress("postgresql:///x", password="secret"))
