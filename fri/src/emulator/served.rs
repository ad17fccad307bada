//! Lets the status that both generations share show a controller of either. They have all that it shows under the same
//! names, and differ in types and in the name of the line that leads back to them. No behaviour.

/// Implements [`Served`](crate::emulator::Served); `$code` is the type of codes on the wire, `$back` the faults of answers.
macro_rules! served {
    ($controller:ty, $state:ty, $quality:ty, $leave:ty, $code:ty, $back:ident) => {
        impl crate::emulator::Served for $controller {
            type State = $state;
            type Quality = $quality;
            type Leave = $leave;

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

            fn shown(&self) -> crate::emulator::Shown {
                let counters = self.counters();
                crate::emulator::Shown {
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
                    falls: self.falls(),
                }
            }

            fn last_leave(&self) -> Option<$leave> {
                self.log().next_back().map(|left| left.reason)
            }

            fn switch(&mut self, power: bool) {
                self.set_power(power);
            }

            fn lines(&mut self) -> [&mut crate::emulator::LineFaults; 2] {
                let faults = self.faults_mut();
                [&mut faults.to_client, &mut faults.$back]
            }

            fn contact(&mut self) -> &mut Option<crate::emulator::Contact> {
                self.contact_mut()
            }
        }
    };
}

pub(crate) use served;
