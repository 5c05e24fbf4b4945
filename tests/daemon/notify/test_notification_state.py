"""The record of what people were told, on a disk that is often a card that wears."""

from daemon.base.state import StateFolder
from daemon.notify.notification_state import FILE_NAME, NotificationState, NotificationStateFile


def test_the_record_of_sent_notices_is_written_only_when_it_has_changed(tmp_path):
    file, kept = NotificationStateFile(StateFolder(tmp_path)), tmp_path / FILE_NAME
    services = {"127.0.0.1:20572": NotificationState()}
    file.save(services)
    file.close()
    before = kept.stat()
    file.save(dict(services))
    file.close()
    assert kept.stat().st_ino == before.st_ino
    file.save({"127.0.0.1:20572": NotificationState(silent=True)})
    file.close()
    assert kept.stat().st_ino != before.st_ino
    assert NotificationStateFile(StateFolder(tmp_path)).load()["127.0.0.1:20572"].silent
