/* A node with many topics: topics NAME publish|hear PREFIX COUNT RATE. Each period it publishes a
 * number on each of them, or it hears them all. */
#include "spin.h"

#include <std_msgs/msg/int64.h>
#include <unistd.h>

static struct spin spin;
static rcl_node_t node;
static int count;
static rcl_publisher_t *publishers;
static rcl_timer_t timer;

static void publish(void *unused) {
  static std_msgs__msg__Int64 message;
  (void)unused;
  message.data++;
  for (int i = 0; i < count; i++) CHECK(rcl_publish(&publishers[i], &message, NULL));
}

static void hear(void *of) {
  std_msgs__msg__Int64 message;
  if (rcl_take(of, &message, NULL, NULL) != RCL_RET_OK) rcl_reset_error();
}

static struct work *make_work(void (*run)(void *), void *of, enum kind kind) {
  struct work *work = calloc(1, sizeof *work);
  *work = (struct work){run, of, of, kind, 0, false, 0, NULL, NULL};
  return work;
}

int main(int argc, char **argv) {
  if (argc != 6) return 2;
  const rosidl_message_type_support_t *number = ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Int64);
  bool hears = !strcmp(argv[2], "hear");
  count = atoi(argv[4]);
  publishers = calloc((size_t)count, sizeof *publishers);
  spin_start(&spin, 1);
  make_node(&spin, &node, argv[1], "");
  for (int i = 0; i < count; i++) {
    char topic[64];
    snprintf(topic, sizeof topic, "/%s_%d", argv[3], i);
    if (hears) {
      rcl_subscription_t *own = calloc(1, sizeof *own);
      MAKE(subscription, own, &node, number, topic, );
      spin_add(&spin, make_work(hear, own, SUBSCRIPTION));
    } else {
      MAKE(publisher, &publishers[i], &node, number, topic, );
    }
  }
  if (!hears) {
    make_timer(&spin, &timer, 1 / atof(argv[5]));
    spin_add(&spin, make_work(publish, &timer, TIMER));
  }
  printf("up\n");
  fflush(stdout);
  for (;;) pause();
}
