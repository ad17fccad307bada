//! Implements the shared status for the controllers of both generations. Both have the same accessor names; only types
//! and the name of the return line differ. No behaviour.

/// Implements [`Served`](crate::emulator::Served); `$code` is the wire type of codes, `$back` the faults of answers, `$close`
/// ends the connection.
macro_rules! served {
    ($controller:ty, $state:ty, $quality:ty, $reason:ty, $code:ty, $back:ident, $close:expr) => {
        impl crate::emulator::Served for $controller {
            type State = $state;
            type Quality = $quality;
            type ExitReason = $reason;

            fn transmit(&mut self, now: std::time::Duration, buf: &mut [u8]) -> Option<usize> {
                self.poll_transmit(now, buf)
            }

            fn take(&mut self, bytes: &[u8], now: std::time::Duration) {
                let _malformed = self.handle_datagram(bytes, now);
            }

            fn due(&self) -> std::time::Duration {
                self.poll_timeout()
            }

            fn state_of(code: i32) -> $state {
                <$code>::try_from(code).unwrap_or(<$code>::MAX).into()
            }

            fn quality_of(code: i32) -> $quality {
                <$code>::try_from(code).unwrap_or(<$code>::MAX).into()
            }

            fn snapshot(&self) -> crate::emulator::Snapshot {
                let counters = self.counters();
                crate::emulator::Snapshot {
                    state: self.state().code().into(),
                    quality: self.quality().code().into(),
                    has_power: self.has_power(),
                    sent: counters.sent,
                    answers: counters.answers,
                    missed: counters.missed,
                    old: counters.old,
                    malformed: counters.malformed,
                    stalls: counters.stalls,
                    commanded: self.set_point(),
                    measured: self.joints(),
                    force: self.force(),
                    exits: self.exits(),
                }
            }

            fn last_exit(&self) -> Option<$reason> {
                self.log().next_back().map(|left| left.reason)
            }

            fn switch(&mut self, power: bool) {
                self.set_power(power);
            }

            fn close(&mut self) {
                let close: fn(&mut Self) = $close;
                close(self);
            }

            fn lines(&mut self) -> [&mut crate::emulator::LineFaults; 2] {
                let faults = self.faults_mut();
                [&mut faults.to_client, &mut faults.$back]
            }
        }
    };
}

pub(crate) use served;
