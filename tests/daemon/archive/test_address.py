"""Addresses of archives: a wrong one, and one with a password, is refused in one sentence."""

import socket
from threading import Thread

import pytest

from daemon.archive.address import (
    ArchiveAddress,
    ArchiveError,
    ArchiveUnreachableError,
    connect_to_archive,
    is_archive,
    load_password,
    parse_archive,
)


def test_an_archive_address_has_a_database_url_and_an_optional_installation():
    found = parse_archive("postgresql://me@db.plant:5433/plant?sslmode=require#site/roof")
    assert (found.url, found.installation) == ("postgresql://me@db.plant:5433/plant?sslmode=require", "site/roof")
    assert str(found) == "postgresql://me@db.plant:5433/plant?sslmode=require#site/roof"
    assert str(parse_archive("postgres:///plant")) == "postgres:///plant"
    assert not is_archive("/var/lib/heliocube")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("postgresql://db.plant", "is not an address of an archive"),
        ("postgresql://db.plant/a/b", "is not an address of an archive"),
        ("mysql://db.plant/a", "is not an address of an archive"),
        ("postgresql://db.plant:port/a", "an archive is postgresql://USER@HOST/DATABASE"),
        ("postgresql://me:secret@db.plant:port/a", "an archive is postgresql://USER@HOST/DATABASE"),
        ("postgresql://me:secret@db..plant/a", "a part of the host's name is empty or longer than 63 letters"),
        ("postgresql:///a?host=db..plant", "a part of the host's name is empty or longer than 63 letters"),
        ("postgresql://db.plant/a?host=/run/a..b,b..c", "a part of the host's name is empty or longer than 63 letters"),
        ("postgresql://me:secret@db.plant/a", "postgresql://me:...@db.plant/a holds a password"),
        ("postgresql://db.plant/a?password=secret", "the address holds a password"),
    ],
)
def test_malformed_archive_addresses_are_refused_and_passwords_in_them_are_not_shown(text, part):
    with pytest.raises(ArchiveError) as error:
        parse_archive(text)
    assert part in str(error.value)
    assert "secret" not in str(error.value)


@pytest.mark.parametrize(
    ("query", "part"),
    [
        ("hostaddr=300.1.1.1", "could not parse network address"),
        ("service=nowhere", "definition of service"),
        ("port=70000", "correct the address"),
    ],
)
def test_an_error_that_waiting_cannot_mend_is_not_reported_as_a_database_that_is_away(query, part):
    pytest.importorskip("psycopg")
    with pytest.raises(ArchiveError, match=part) as error:
        connect_to_archive(parse_archive(f"postgresql:///plant?{query}"), "a test")
    assert not isinstance(error.value, ArchiveUnreachableError)


def test_a_refusal_in_another_language_is_reported_in_the_database_servers_own_words():
    pytest.importorskip("psycopg")
    said = "Passwort-Authentifizierung für Benutzer »me« fehlgeschlagen"
    fields = b"".join(part.encode() + b"\0" for part in ("SFATAL", "VFATAL", "C28P01", f"M{said}", ""))

    def refuse():
        caller, _ = listening.accept()
        with caller:
            caller.recv(1000)
            caller.sendall(b"E" + (len(fields) + 4).to_bytes(4, "big") + fields)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = Thread(target=refuse)
        server.start()
        url = f"postgresql://me@127.0.0.1:{listening.getsockname()[1]}/plant?sslmode=disable&gssencmode=disable"
        with pytest.raises(ArchiveUnreachableError) as error:
            connect_to_archive(parse_archive(url), "a test")
        server.join()
    assert str(error.value) == f"the database {url} refuses: {said}"


def test_a_malformed_host_in_pghost_is_refused_in_one_sentence(monkeypatch):
    pytest.importorskip("psycopg")
    monkeypatch.setenv("PGHOST", "db..plant")
    with pytest.raises(ArchiveError, match="is not an address of a database"):
        connect_to_archive(parse_archive("postgresql:///plant"), "a test")


def test_a_password_file_must_have_one_line_and_be_readable_by_its_owner_only(tmp_path):
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
