// libjpeg reports through callbacks of C: fatal errors come back by longjmp to the guarded call,
// which throws. Nothing with a destructor may live between Guard's setjmp and the library.
#pragma once

#include <csetjmp>
#include <cstdio>
// jpeglib.h needs FILE and size_t before it.
#include <jerror.h>
#include <jpeglib.h>

namespace sirpy {

struct JpegErrors {
  jpeg_error_mgr manager;  // first, since libjpeg's pointer to it is also ours
  std::jmp_buf jump;
  char message[JMSG_LENGTH_MAX] = {};

  // To be given to cinfo.err.
  jpeg_error_mgr* Install();
};

// Runs `call`; on a fatal error of libjpeg runs `fail`, which throws.
template <typename Call, typename Fail>
void GuardJpeg(JpegErrors& errors, Call call, Fail fail) {
  if (setjmp(errors.jump) != 0) {
    fail();
    return;
  }
  call();
}

}  // namespace sirpy
